"""Topics: list, info, subscribe, stats, publish; a file for each verb."""
