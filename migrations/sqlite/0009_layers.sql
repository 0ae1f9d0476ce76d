-- The layers of a mark. Until now every mark had the blind layer alone.
-- 'blind', 'relief' or 'both'.
ALTER TABLE watermarks ADD COLUMN layers TEXT NOT NULL DEFAULT 'blind';
-- How far the relief moves the surface: root mean square distance as a share of the diagonal; null
-- without a relief.
ALTER TABLE watermarks ADD COLUMN amplitude REAL;
