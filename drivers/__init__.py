"""One file a kind of robot. A driver knows its robot and nothing of the bus."""
