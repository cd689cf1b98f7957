"""Charts, computed once and rendered for papers by matplotlib or for pages by plotly.js."""
