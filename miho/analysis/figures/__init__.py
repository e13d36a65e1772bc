"""Figures as functions of tidy data. Importing one of these modules loads matplotlib, seaborn."""
