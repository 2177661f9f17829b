"""Contacts of parts where they rest, and the precedence that follows from them.

Assemblies of parts and constructions use it.
"""
