"""From samples and measurements in the order of their arrival to one estimate: the only path to a filter."""
