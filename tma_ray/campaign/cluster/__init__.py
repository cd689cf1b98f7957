"""The Ray that a campaign runs on: started here or joined, and its head watched."""
