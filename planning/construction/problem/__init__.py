"""What is to be built, of which parts, by whom, and whether it can be."""
