"""What a person at a run uses: commands, requests, the emergency stop, terminal and page."""
