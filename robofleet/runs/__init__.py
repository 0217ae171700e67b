"""What puts nodes together: the table of processes, launcher, lockstep, checks, replay."""
