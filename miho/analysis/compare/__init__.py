"""Methods against each other: what they reached, what it cost, and whether that is chance."""
