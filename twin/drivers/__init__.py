"""Interface of a driver, the built-in drivers, and the drivers file."""
