"""Pure navigation mathematics on float64 arrays: rotations, the Earth, the mechanization, layouts, linear algebra."""
