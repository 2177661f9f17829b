"""``twin import step``: a scenario from the STEP file of an assembly."""
