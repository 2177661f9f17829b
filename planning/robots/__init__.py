"""Robot models and the registry of those that scenarios can name."""
