"""Space: the neighbour grid, bodies seen as signed distance, placement of particles."""
