"""The kinds of assemblies that a scenario can describe, each behind the same few functions."""
