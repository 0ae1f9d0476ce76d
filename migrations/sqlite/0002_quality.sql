-- What a mark did to its mesh, as measured when it was made: JSON with mrms, hausdorff and
-- max_displacement (shares of the bounding box's diagonal), normal_deviation_degrees, flipped and
-- method_used. Null in records of before it was measured.
ALTER TABLE watermarks ADD COLUMN quality TEXT;
