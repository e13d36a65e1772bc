"""Streams of rows to a method that tracks parameters, and its states."""
