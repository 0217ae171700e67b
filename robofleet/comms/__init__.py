"""What crosses processes: messages, topics, the bus."""
