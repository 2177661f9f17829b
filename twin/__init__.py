"""Digital twin: scenarios, execution, studies, and the program.

Imports scheduling and planning. cli.py is the program; every room but commands is below it.
"""
