"""What a solver gains by sharing numbers with the generator, tested on frames whose sky differs from every solver's."""
