"""Figures as functions of tidy data, by matplotlib; figures of comparisons also load seaborn."""
