"""Files that vendors give beside a robot description: SRDF, what MJCF says alike, and sources in xacro.

Imports robots.
"""
