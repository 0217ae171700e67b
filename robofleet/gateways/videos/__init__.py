"""Videos of others: poses without a fleet."""
