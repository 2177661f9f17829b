"""The event engine: robots and dispatcher as processes (APEX-MR IV-D)."""
