"""A projector: photographed patterns, and what they tell."""
