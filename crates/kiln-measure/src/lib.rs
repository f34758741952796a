//! How far two assets are apart: renders, surface distance, contact sheets.
