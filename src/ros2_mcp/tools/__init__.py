"""What the model sees: one module per family of tools."""
