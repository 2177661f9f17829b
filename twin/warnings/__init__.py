"""Warnings about a plan before its execution: stalls, time windows, overloaded joints and unreachable speeds."""
