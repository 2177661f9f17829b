"""What lies on what: contacts of parts where they lie, and what must come before what because of them.

Assemblies of parts and constructions use it.
"""
