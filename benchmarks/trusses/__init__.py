"""Trusses of round bars for measuring: generated cells and structures, and what planning takes for them."""
