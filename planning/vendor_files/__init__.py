"""Files that vendors give beside a robot description: SRDF, and what MJCF says alike.

Imports robots.
"""
