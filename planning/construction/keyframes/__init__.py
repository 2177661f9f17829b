"""Where and when a part is picked, handed over and placed (Hartmann et al. IV-B)."""
