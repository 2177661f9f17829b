"""Planning pipeline: from a scenario to its temporal plan graph, stage by stage.

Imports scenario, assemblies, scheduling and planning; commands, comparison and study import it.
"""
