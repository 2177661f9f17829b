"""Descriptions of robots and tools: read, checked, and fitted to each other for a cell.

Imports cell and meshes.
"""
