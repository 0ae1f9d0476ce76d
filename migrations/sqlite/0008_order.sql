-- Pages of one owner in the order of registration, which is that of the rows: an id is drawn before its
-- mark is made, so a slow marking is registered after faster ones with later ids. (What 0001 says of
-- ids and pages is of before that was seen. An index ends with the row number by itself.)
CREATE INDEX watermarks_by_owner_in_order ON watermarks (owner_id);
