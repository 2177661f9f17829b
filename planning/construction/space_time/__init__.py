"""Paths through space-time among everything that is planned already (Hartmann et al. IV-C)."""
