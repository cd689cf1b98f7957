"""The head of the Ray that a campaign runs on: started or joined, and watched."""
