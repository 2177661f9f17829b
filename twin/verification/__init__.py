"""Command ``twin verify``: verification of saved plans."""
