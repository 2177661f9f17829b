"""Performance of lines: takt, throughput, lateness and work in progress of products.

Imports runs; studies import it.
"""
