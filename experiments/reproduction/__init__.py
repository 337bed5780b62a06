"""The reproduction of the paper: its numbers, and the page that sets ours beside them."""
