"""Figures of a fit and the style that all figures share."""
