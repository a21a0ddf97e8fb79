"""Grains instead of a law: a packing of disks at every integration point, behind the contract of all laws."""
