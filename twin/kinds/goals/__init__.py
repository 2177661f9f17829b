"""Motions of robots to goal configurations and poses, without an assembly."""
