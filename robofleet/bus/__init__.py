"""What crosses processes: topics, messages, the bus (Zenoh or memory), and the files by which runs are found."""
