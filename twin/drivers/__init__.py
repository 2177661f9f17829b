"""Robot drivers: their interface, the built-in drivers, and the drivers file."""
