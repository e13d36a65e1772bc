"""Figures as functions of tidy data, by matplotlib; those of comparisons load seaborn as well."""
