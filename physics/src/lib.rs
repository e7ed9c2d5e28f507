//! The body simulator: seven bodies, six joints, contacts, named effects, many trials side by side.
