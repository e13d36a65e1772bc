"""Figures as functions of tidy data, by matplotlib."""
