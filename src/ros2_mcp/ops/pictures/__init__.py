"""Pictures of maps, clouds and numbers."""
