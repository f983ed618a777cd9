"""Dispatch: who takes which order, and who goes to which charger. Every refusal carries its reason."""
