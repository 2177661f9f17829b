"""Assembly plans from geometry, by disassembly: order, straight insertions, sub-assemblies, holds and fits.

``assembly_plan.plan_assembly`` is the entry point.
"""
