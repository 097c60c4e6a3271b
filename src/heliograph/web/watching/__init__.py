"""Sources, controls and display of watched receptions."""
