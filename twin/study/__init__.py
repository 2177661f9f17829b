"""Monte-Carlo studies: many replications of a plan under uncertainty, and what they tell."""
