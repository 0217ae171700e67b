"""Other computers: keys, permissions, bundles, the router that they reach."""
