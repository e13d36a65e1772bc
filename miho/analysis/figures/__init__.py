"""Figures as functions of tidy data. Importing one loads matplotlib; all but the report's, seaborn."""
