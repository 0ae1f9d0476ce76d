-- Which registered marks the host already carried when it was marked: JSON, a list of objects with
-- watermark_id, owner_id and log10_fp (the bound, all hypotheses counted), best first. Null where
-- nobody looked: the request allowed any, or the record is of before hosts were looked at.
ALTER TABLE watermarks ADD COLUMN existing_marks TEXT;
