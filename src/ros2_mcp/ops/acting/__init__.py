"""What operations that act share: values filled in, orders to vehicles, how an act ended."""
