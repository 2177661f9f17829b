"""Checks of assemblies of parts: grips, holds, places, reach, loads, windows of time, and how parts fit."""
