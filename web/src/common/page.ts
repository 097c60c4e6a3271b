// What every page does: it takes the token from its address, so that links to other pages need not carry it.

import "./token";
