"""The experiments of Hartmann et al., measured: plans, their checks, a baseline, and reports."""
