"""A car put together of what was identified: from bench data, from drives, from files."""
