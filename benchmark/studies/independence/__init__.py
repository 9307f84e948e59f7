"""What a solver that shares numbers with the generator gains from it: frames whose sky differs from every solver's."""
