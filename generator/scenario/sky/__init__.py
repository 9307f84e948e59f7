"""Parts of the scenario's ``sky`` section."""
