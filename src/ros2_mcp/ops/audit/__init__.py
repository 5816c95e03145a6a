"""Read the audit."""
