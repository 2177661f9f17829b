"""Replications of a study with replanning, and the plans with hindsight that they are compared with."""
