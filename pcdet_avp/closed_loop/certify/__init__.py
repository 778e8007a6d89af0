"""A speed certificate: up to which speed is every crash rate bounded, at a chosen level of confidence?"""
