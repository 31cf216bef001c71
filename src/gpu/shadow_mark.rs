//! Visibility buffer → the columns of pages of shadow maps that its pixels may look up.
