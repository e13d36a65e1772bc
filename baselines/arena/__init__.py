"""Comparisons of methods: results and figures of the arena, and readings of the paper."""
