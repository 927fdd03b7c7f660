"""Contact, tracking, deformation, slip and loading: each stage states what it needs and what it gives."""
