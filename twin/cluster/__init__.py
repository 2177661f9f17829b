"""Clusters: certificates, a scheduler and workers that only their holders reach, and their use.

Addresses and certificates are plain data; who serves and who asks import ``distributed`` late.
"""
