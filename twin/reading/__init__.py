"""Reading and checking scenario files.

Imports document, scenario and planning; trial imports it.
"""
