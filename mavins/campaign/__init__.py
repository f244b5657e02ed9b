"""Many runs at once: Monte-Carlo series of simulated flights, and archives of logs, on all cores or on a cluster."""
