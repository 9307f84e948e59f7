"""The inertial unit of a sequence: true angular rate and specific force, errors from Allan parameters, and their table."""
