"""Rivals of MIHO: wrapped libraries, and `miho.methods`."""
