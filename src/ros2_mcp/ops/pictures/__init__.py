"""Pictures of maps, point clouds and plots of numeric fields, with their numbers."""
