"""The programs of fishrl, ``fishrl <program> key=value``; only ``experiments`` imports them."""
