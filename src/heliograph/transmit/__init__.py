"""transmit"""
