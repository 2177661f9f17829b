"""Checks of assemblies of parts: grips, holds, places, reach, loads, time windows, and fits."""
