"""Plug-ins that ship with HESR. They use the core; the core imports none of them."""
