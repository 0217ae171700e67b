"""Files: YAML, CSV, parameters and robots' own files, read with positions."""
