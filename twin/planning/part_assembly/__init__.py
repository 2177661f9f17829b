"""Assemblies of parts: what their section becomes for planning, and for the audit.

Imports scenario.sections; twin.planning imports it.
"""
