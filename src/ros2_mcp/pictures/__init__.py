"""Pictures for agents: maps, scenes, plots, camera images."""
