"""perdure: train a policy in finite episodes, deploy it without end, and know beforehand whether it holds."""
