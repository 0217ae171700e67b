"""Many runs: storm and sweep: what is drawn, what is judged, where it runs."""
