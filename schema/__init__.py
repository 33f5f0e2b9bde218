"""What a lake is: table and array contracts, closed-form geometry, snapshots."""
