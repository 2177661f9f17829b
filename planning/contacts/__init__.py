"""Contacts of parts where they rest, and the precedence that follows from them.

Imports cell and geometry; parts and constructions import it.
"""
