"""Work in other processes and on other machines: workers, what they evaluate, and its journal."""
