"""Scenario files: sections, schema, manifests, variations of keys, and scenarios shipped with the program."""
