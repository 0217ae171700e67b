"""The operator's page: a server beside the run, which can end and come back without the run's noticing."""
