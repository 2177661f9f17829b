"""Tests of the program; a regular package, as third parties (Ciw) install one of the same name."""
