import"./token.js";
