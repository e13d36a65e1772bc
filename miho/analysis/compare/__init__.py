"""Comparison of methods: accuracy, cost and statistical significance."""
