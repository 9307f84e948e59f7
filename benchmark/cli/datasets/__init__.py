"""Commands on datasets: plan, generate, verify, export, show."""
