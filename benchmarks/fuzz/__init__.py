"""Mutated input for every command: each must end in a sentence, in time and in bounded memory.

python -m benchmarks.fuzz [TARGET ...] [--cases N] [--seed S] [--json FILE]
"""
