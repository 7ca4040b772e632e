"""Certificates, guarantees, and the plain implementation that checks them."""
