"""Assembly of a car from identified parts: from bench data, from drives, or from files."""
