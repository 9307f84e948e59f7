"""The inertial unit of a sequence: true angular rate and specific force, errors by Allan parameters, and their table."""
