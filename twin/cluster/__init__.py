"""Clusters for parallel computation: certificates, a Dask scheduler, and workers that require a certificate.

Addresses and certificates are plain data; modules of servers and clients import ``distributed`` only when needed.
"""
