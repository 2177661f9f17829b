"""Gains: estimated reduction of makespans by interventions, each of which shortens a part of a plan."""
