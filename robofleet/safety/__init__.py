"""What may reach a wheel. Pure."""
