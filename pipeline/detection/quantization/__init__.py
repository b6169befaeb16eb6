"""Quantization of networks to integers of 8 bits, at installation (ADR 17)."""
