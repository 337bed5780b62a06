"""Wrappers for users of other frameworks; nothing else in fishrl imports them."""
